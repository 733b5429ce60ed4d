# Texte von robot.js und woraus es besteht.
robot-title = Roboter
robot-lead = Wo steht die Zelle in den Koordinaten des Roboters? Sie tasten ein paar Stellen an, die die Kameras sehen, oder fahren ein paar Posen an, und tragen ein, was der Roboter anzeigt. Nach jeder sagt diese Seite, was sie wert ist.
robot-no-rig = Es gibt noch keine Kalibrierung: kalibrieren Sie zuerst.
robot-is-fixed = Die Zelle gibt ihre Ergebnisse in den Koordinaten des Roboters.
robot-is-flange = Der Roboter trägt die Kameras, und die Zelle weiß, wie.
robot-is-none = Noch nicht registriert: Ergebnisse sind in den Koordinaten der Kameras.
robot-is-unknown = Noch nicht bekannt: die Zelle hat keinen Job, nach dem sie misst.
robot-stale = Die Zelle hat eine andere Kalibrierung als die, mit der dies begonnen wurde. Beginnen Sie eine neue Registrierung.
robot-how = Wie soll es geschehen?
robot-mount = Wo sind die Kameras?
robot-mount-fixed = Sie stehen fest, neben oder über dem Roboter
robot-mount-flange = Der Roboter trägt sie
robot-way = Wie sagt der Roboter, wo er ist?
robot-way-touch = Seine Spitze tastet sechs Stellen an. Der TCP der Spitze muss gut bekannt sein.
robot-way-poses = Er hält eine Tafel, in zehn Posen. Nichts wird angetastet, kein TCP ist nötig.
robot-what-touch = Was tastet die Spitze an?
robot-what-held = Welche Tafel hält der Flansch?
robot-what-lies = Welche Tafel liegt fest vor den Kameras?
robot-what-part = Ein Teil: { $job }
robot-what-board = Eine andere Tafel
robot-brand = Roboter
robot-brand-unknown = Ich weiß nicht, wie er Posen schreibt
robot-begin = Beginnen
robot-program = Das eigene Programm des Roboters kann alles allein, mit ein paar Befehlen an die Zelle.
robot-program-later = Solange jemand die Zelle hat, nimmt sie keinen Befehl von Roboter oder SPS an: Geben Sie sie zurück, und starten Sie dann jenes Programm. Seine Posen oder Punkte erscheinen hier, wie sie kommen.
robot-program-how = Wie das geht
robot-walks = Das eigene Programm des Roboters registriert die Zelle gerade: seine Posen oder Punkte erscheinen hier, wie sie kommen.
robot-walked = Diese hat das eigene Programm des Roboters aufgenommen.
robot-new = Eine neue beginnen
robot-begun-touch = Angetastete Punkte
robot-begun-poses = Posen des Flanschs
robot-begun-samples =
    { $samples ->
        [one] bisher eine
       *[other] bisher { $samples }
    }
robot-discard-what = Alle ihre Punkte und Posen sind dann weg. Eine Registrierung in Gebrauch bleibt.
robot-take-cell = Nehmen Sie die Zelle: ihre Kameras werden gebraucht.
robot-taking = Das Bild wird aufgenommen …
robot-name-point = Punkt { $number }
robot-name-pose = Pose { $number }

## Antasten
robot-touch-title = Punkt { $number } von { $wanted }
robot-touch-what = Legen Sie die Tafel oder das Teil hin, der Roboter aus dem Weg, und nehmen Sie ein Bild auf. Lassen Sie dann alles liegen und tasten Sie die Stelle im Fadenkreuz an.
robot-look = Ein Bild davon aufnehmen
robot-look-again = Es liegt jetzt anders: ein neues Bild
robot-live = Live-Bilder
robot-look-none = In diesem Bild war nichts zum Antasten zu finden.
robot-look-length = Die Tafel ist nach dieser Kalibrierung um { $percent } % länger, als ihre mm sagen. Messen Sie ihre Felder nach: entweder sind die mm hier falsch, oder die der Kalibrierung; dann kalibrieren Sie neu.
robot-look-wrong = Die Tafel hat eine andere Länge, als ihre mm sagen.
robot-look-found = Gefunden: { $count } Stellen.
robot-picture = Das aufgenommene Bild. Sein Fadenkreuz steht auf der Stelle, die unten gewählt ist.
robot-place = Stelle (die vorgeschlagene sagt am meisten)
robot-place-mark = Marke in Zeile { $row } von 3, Spalte { $column } von 3
robot-place-circle = Mitte von Kreis { $name }
robot-place-slot = Mitte von Langloch { $name }
robot-place-corner = Ecke { $name }
robot-place-reference = Bezugspunkt des Teils
robot-touched = angetastet
robot-touch-now = Die Spitze steht genau auf der Stelle im Fadenkreuz. Was zeigt der Roboter an?
robot-add = Diesen Punkt nehmen
robot-point-taken = Genommen. { $count } Punkte.

## Posen
robot-pose-title = Pose { $number } von { $wanted }
robot-pose-fixed = Der Flansch hält die Tafel: fahren Sie dorthin, wo beide Kameras sie ganz sehen, anders geneigt und gedreht als zuvor. Stillstehen.
robot-pose-flange = Die Tafel liegt fest: fahren Sie die Kameras dorthin, wo beide sie ganz sehen, anders geneigt und gedreht als zuvor. Stillstehen.
robot-pose-take = Bild in dieser Pose aufnehmen
robot-pose-taken = { $name } ist aufgenommen.
robot-pose-unseen = { $name }: die Tafel war nicht gut genug zu sehen.
robot-bare = { $count } der Bilder warten noch auf das, was der Roboter dort anzeigte: tragen Sie es unten in der Liste ein, oder fügen Sie mehrere Zeilen auf einmal ein.

## Was der Roboter anzeigt
robot-shown = Was der Roboter anzeigt
robot-paste = oder hier einfügen, in beliebiger Form: mit Tabulatoren, Kommas, Klammern, Gradzeichen
robot-clear = Leeren
robot-spread = { $count } Zeilen den wartenden Bildern geben
robot-stage-shows = Bühne: was der virtuelle Roboter anzeigt
robot-stage-walk = Bühne: Roboter in die nächste Pose

## Was sie sagen
robot-verdict = Was sie sagen
robot-judging = (wird angesehen …)
robot-good = Alle stimmen überein.
robot-sigma = Eine Stelle mitten darin, in den Koordinaten des Roboters (1 σ)
robot-held-out = Am weitesten von da, wo alle anderen es erwarten
robot-held-rms = Von da, wo alle anderen sie erwarten, an der Tafel (rms)
robot-limit = { $mm } mm (Grenze { $limit } mm)
robot-um = ± { $um } µm
robot-mm = { $mm } mm
robot-more = Noch einer davon
robot-scale = Längen des Roboters zu denen der Kameras (soll 1 sein)
robot-trouble-too-few = Bisher { $count }, mindestens { $least } sind nötig.
robot-trouble-no-brand = Wessen Roboter ist es? Wählen Sie oben; was am besten passt, steht unten.
robot-trouble-culprit = { $name } ist um { $mm } mm falsch: ohne ihn stimmen die anderen auf { $others } mm überein. Tasten Sie noch einmal an, oder verbessern Sie das Getippte.
robot-trouble-scale = Die Längen des Roboters weichen von denen der Kameras um { $percent } % ab (± { $sigma } %). Messen Sie die Felder der Kalibriertafel nach: ihre mm sind falsch. Oder der TCP ist es.
robot-trouble-disagree = Sie widersprechen sich um { $mm } mm, die Grenze ist { $limit } mm, und keiner allein ist schuld. Nehmen Sie mehr davon, mit Sorgfalt.
robot-trouble-other-reading = Diese Zahlen lesen sich als { $reading }, Längen in { $unit }, Kameras { $mounted }: das ist { $whose }. Sie sagten { $said }. So gelesen stimmen sie auf { $mm } mm überein.
robot-trouble-on-one-line = Die Punkte liegen auf einer Geraden: die Drehung um sie bleibt offen. Tasten Sie eine Stelle daneben an.
robot-trouble-same-place = { $one } und { $two } sind fast dieselbe Stelle. Lassen Sie einen weg und tasten Sie eine andere an.
robot-trouble-turns-missing = Die Posen drehen sich nicht genug: sehen Sie den Himmel unten an.
robot-trouble-other-units = Diese Längen sehen nach { $unit } aus: andere Einheiten, als das Bediengerät dieses Roboters anzeigt. Ist es der richtige Roboter?
robot-trouble-mirrored = Die Punkte sind die eines Spiegels: eine Achse hat das falsche Vorzeichen, oder zwei sind vertauscht.
robot-trouble-calibration = Daraus lässt sich nichts lösen: { $detail }
robot-trouble-refused = Jetzt wird nichts dazu gesagt: { $detail }
robot-nobodys = keines Roboters übliche Art
robot-read-so = Als { $brand } lesen
robot-advice-more = Mehr davon machen es besser und zeigen Fehler: sechs Punkte oder zehn Posen sind gut.
robot-advice-flat = Alle Punkte liegen in einer Ebene. Legen Sie Tafel oder Teil für die nächsten höher: dann zeigt sich auch eine gespiegelte Achse.
robot-advice-all = Drehen Sie den Flansch zwischen den Posen: neigen Sie ihn um 15° nach verschiedenen Seiten, und drehen Sie die Hand.
robot-advice-tilt = Der Flansch hat sich nur um sich selbst gedreht. Neigen Sie ihn um 15° nach verschiedenen Seiten.
robot-advice-wrist = Der Flansch hat sich nur hin und her geneigt. Neigen Sie ihn auch nach den anderen Seiten, oder drehen Sie die Hand um 30°.
robot-conventions = Wie diese Zahlen zu lesen sind, das Beste zuerst
robot-reading = Orientierung
robot-lengths = Längen
robot-cameras = Kameras
robot-off = Daneben um
robot-mounted-fixed = fest stehend
robot-mounted-flange = getragen
robot-reading-vector-rad = ein Drehvektor in rad
robot-reading-vector-deg = ein Drehvektor in Grad
robot-reading-zyx-deg = Winkel um Z, das neue Y, das neue X, in Grad
robot-reading-zyx-rad = Winkel um Z, das neue Y, das neue X, in rad
robot-reading-fixed-deg = Winkel um die festen X, Y, Z, in Grad
robot-reading-fixed-rad = Winkel um die festen X, Y, Z, in rad
robot-reading-moving-deg = Winkel um X, das neue Y, das neue Z, in Grad
robot-reading-moving-rad = Winkel um X, das neue Y, das neue Z, in rad
robot-reading-oat-deg = Winkel O, A, T in Grad
robot-reading-oat-rad = Winkel O, A, T in rad
robot-reading-scalar-first = ein Quaternion, Skalar zuerst
robot-reading-scalar-last = ein Quaternion, Skalar zuletzt
robot-sky = Wie sich der Flansch gedreht hat
robot-sky-what = { $count } Posen, von der ersten aus gesehen.
robot-sky-whole = Er hat sich um verschiedene Achsen gedreht: gut.
robot-sky-all = Er hat sich kaum gedreht: die Pfeile zeigen, wie.
robot-sky-tilt = Er hat sich nur um sich selbst gedreht: die Pfeile zeigen, wohin er sich neigen soll.
robot-sky-wrist = Er hat sich nur hin und her geneigt: der Pfeil zeigt die Drehung der Hand, die fehlt.
robot-sky-one = { $name }: um { $tilt }° geneigt, um { $turn }° gedreht
robot-sky-hint = Jede Zahl ist eine Pose, so weit von der Mitte, wie der Flansch geneigt war; ihr Zeiger zeigt die Drehung der Hand.

## Die Liste
robot-samples = Punkte und Posen ({ $count })
robot-samples-touch = Die Zahl ist der Abstand von da, wo alle anderen Punkte diesen erwarten; der Strich ist die Grenze. Neben einem falschen Punkt können auch die Nachbarn große haben: der falsche wird genannt.
robot-samples-poses = Die Zahl ist der Abstand an der Tafel von da, wo alle anderen Posen sie erwarten; der Strich ist die Grenze.
robot-why-culprit = Falsch, wenn die anderen stimmen.
robot-why-left-out = Von Hand weggelassen.
robot-why-not-seen = Die Tafel war nicht gut genug zu sehen.
robot-why-length = Eine andere Länge, als ihre mm sagen.
robot-why-no-numbers = Was hat der Roboter angezeigt?
robot-why-misfit = Nicht so viele Zahlen, wie dieser Roboter anzeigt.
robot-why-outlier = Passt nicht zu den anderen und zählt nicht.
robot-edit = Eintragen
robot-edit-name = Eintragen, was der Roboter bei { $name } anzeigte
robot-remove = Weglassen
robot-remove-name = { $name } weglassen
robot-restore = Wieder nehmen
robot-restore-name = { $name } wieder nehmen
robot-write = So behalten
robot-undo = Rückgängig
robot-redo = Wiederholen
robot-undone = Rückgängig gemacht.
robot-redone = Wiederholt.

## Behalten
robot-keep = Behalten
robot-keep-what = Es wird neben der Kalibrierung behalten und dann durch ein weiteres Antasten bewiesen. In der Zelle ändert sich noch nichts.
robot-solve = Diese Registrierung behalten
robot-go = Der Beweis: fahren Sie dorthin
robot-go-look = Legen Sie die Tafel oder ein Teil vor die Kameras und nehmen Sie ein Bild auf: dann steht hier, wohin der Roboter muss.
robot-go-flange = Die Tafel liegt, wo sie bei der letzten Pose lag.
robot-go-there = { $place }, in den Koordinaten des Roboters:
robot-go-slow = Langsam, zuerst 50 mm darüber. Tasten Sie dann die Stelle nach Augenmaß an und tragen Sie ein, was der Roboter anzeigt.
robot-confirm = Wie weit war es daneben?
robot-off-by = { $mm } mm daneben.
robot-off-more = Das ist viel: tasten Sie mehr Stellen an, oder sehen Sie nach, ob der TCP stimmt.
robot-activate = Diese Registrierung verwenden
robot-activate-title = Diese Registrierung verwenden?
robot-note =
    { $brand }, { $count ->
        [one] { $count } Messung
       *[other] { $count } Messungen
    }
robot-activate-what = Von da an gibt die Zelle alle Ergebnisse in den Koordinaten des Roboters. Es wird ein eigenes Release; zurück geht es mit einem Tippen auf der Seite System.
robot-activated = In Gebrauch, als Release { $number }.
robot-active = In Gebrauch.

## Karte des Roboterfehlers
robot-map = Karte des Roboterfehlers
robot-map-what = Um diese Karte ist jeder Ort verschoben, den die Zelle dem Roboter gibt. Teile jenseits der angetasteten Orte werden abgelehnt. Die Karte gehört zu dieser Registrierung: Wird neu registriert, ist sie weg.
robot-map-points = Angetastete Orte
robot-map-degree = { $count }, Karte vom Grad { $degree }
robot-map-left-out = Abweichung ausgelassener Orte (rms)
robot-map-from-to = { $held }; ohne die Karte { $alone }
robot-map-noise = Was die Karte nicht sagt (1 σ)
robot-map-hull = Sie reichen über
robot-map-picture = Die Orte von oben. Jede Linie zeigt, wo der Roboter stattdessen war, { $times }-fach zu lang; die längste ist { $um } µm.
robot-um-plain = { $um } µm
