# Texte der Seite, die einen Auftrag einlernt.

teach-title = Einlernen
teach-what = Zeigen Sie das Teil einmal beiden Kameras. edged schlägt vor, woran es misst, und sagt bei jedem Tippen, wie genau die Koordinaten damit werden.
teach-no-rig = Es gibt noch keine Kalibrierung: ohne sie hat kein Bild Millimeter.

## Wie man beginnt
teach-begin = Ein neues Teil
teach-begin-what = Legen Sie das Teil hin, wo es gemessen wird, mit nichts anderem darum herum.
teach-take = Bildpaar aufnehmen
teach-taking = Einen Augenblick …
teach-take-cell = Nehmen Sie die Zelle, um ein Paar aufzunehmen: ihre Kameras werden gebraucht.
teach-known = Aufträge dieser Zelle
teach-known-what = Ändern Sie einen auf dem Paar, mit dem er eingelernt wurde, oder lernen Sie ihn neu ein. Er bleibt, wie er ist, bis Sie den neuen benutzen.
teach-edit = Ändern
teach-edit-job = { $name } ändern
teach-again = Neu einlernen
teach-again-job = Neu einlernen: { $name }, aus einem frischen Paar

## Der Entwurf
teach-undo = Rückgängig
teach-redo = Wiederholen
teach-undone = Rückgängig gemacht.
teach-redone = Wiederholt.
teach-other = Anderes Teil
teach-discard-what = Das Paar und alles, was darauf gewählt wurde, ist dann weg. Ein Auftrag in Gebrauch bleibt.
teach-changes = ändert { $job }
teach-proposing = Sucht, was sich messen lässt …
teach-trouble = Daraus wird noch nichts gelernt:

## Was es taugt
teach-predicted = Zu erwarten bei diesem Teil, wo es jetzt liegt
teach-predicted-later = Tippen Sie im linken Bild auf das Teil.
teach-predicted-none = Mit dem, was jetzt genommen ist, lässt sich keine Lage sagen: nehmen Sie mindestens einen Kreis, ein Langloch oder zwei Kanten.
teach-free = unbekannt: nicht zu unterscheiden
teach-better = war ± { $before }
teach-worse = war ± { $before }
teach-no-rivals = Keine andere Drehung sieht so aus.
teach-rival = Um { $angle }° gedreht sieht es sich selbst zu { $percent } % ähnlich: nehmen Sie ein Merkmal, das sich dort unterscheidet, sonst kann die Drehung falsch sein.
teach-far-rival = Um { $angle }° gedreht sieht es sich selbst zu { $percent } % ähnlich: das wird unterschieden.

## Die Bilder
teach-tools = Was ein Tippen ins linke Bild tut
teach-choose = Merkmale nehmen und lassen
teach-now-choose = Tippen Sie auf einen Umriss oder mitten in ein Loch: durchgezogen mit Haken ist genommen, gestrichelt gelassen.
teach-now-reference = Tippen Sie auf den Punkt, dessen Koordinaten ausgegeben werden: edged nimmt die Mitte dessen, was dort ist.
teach-now-gripping = Tippen Sie, wo der Greifer fassen soll.
teach-picture-left = Linkes Bild. Pfeile bewegen ein Kreuz, Enter tippt dort, Plus und Minus vergrößern, 0 zeigt alles.
teach-picture-right = Rechtes Bild, derselbe Ausschnitt
teach-look = Ansehen
teach-look-at = { $key } ansehen
teach-place-reference = Bezug
teach-place-gripping = Griff
teach-place-reference-said = Der Bezugspunkt ist gesetzt.
teach-place-gripping-said = Der Greifpunkt ist gesetzt.

## Wo das Teil ist
teach-part = Wo das Teil ist
teach-tool-tap = Tippen
teach-tool-rectangle = Rechteck
teach-tool-circle = Kreis
teach-tool-polygon = Vieleck
teach-tool-brush = Radieren
teach-tool-tap-what = Tippen Sie auf das Teil: der Bereich wächst bis zu seinem Umriss.
teach-tool-rectangle-what = Ziehen Sie von Ecke zu Ecke, oder tippen Sie beide an.
teach-tool-circle-what = Ziehen Sie von der Mitte zum Rand, oder tippen Sie beide an.
teach-tool-polygon-what = Tippen Sie Ecke um Ecke; die erste noch einmal schließt es.
teach-tool-brush-what = Übermalen Sie, was nicht das Teil ist, etwa einen Schatten oder ein Etikett.
teach-cut = Ausschneiden
teach-place = Eines in die Mitte setzen
teach-close = Schließen
teach-no-region = Noch nichts: gelernt würde das ganze Bild.
teach-adds = { $kind } { $shape }
teach-cuts = { $kind } { $shape }, ausgeschnitten
teach-remove = Entfernen
teach-remove-shape = Form { $shape } entfernen
teach-shape-rectangle = Rechteck
teach-shape-circle = Kreis
teach-shape-polygon = Umriss
teach-shape-brush = Radierter Strich
teach-handle = { $kind } { $shape }, Punkt { $point }: { $x }, { $y } px. Pfeile bewegen ihn.

## Merkmale
teach-features = Merkmale: { $taken } von { $count } genommen
teach-features-what = Gemessen wird an dem, was genommen ist. Lassen Sie, was unscharf ist oder sich am Teil bewegt.
teach-no-features = Sie kommen, wenn die Zelle weiß, wo das Teil ist.
teach-take-all = Alle nehmen
teach-taken-said = { $key } ist genommen.
teach-left-said = { $key } ist gelassen.
teach-kind-circle = Kreis
teach-kind-slot = Langloch
teach-kind-edge = Kante
teach-kind-corner = Ecke
teach-kind-curve = Kurve
teach-size-diameter = Ø { $mm } mm
teach-size-length = { $mm } mm lang
teach-size-width = { $mm } mm breit
teach-why-not-seen = in diesem Paar nicht zu sehen
teach-why-left-out = von Hand weggelassen
teach-warnings = Sehen Sie sich das an
teach-warning-cut = Der Umriss ist abgeschnitten.
teach-warning-round = Es ist rund: seine Drehung lässt sich nicht sagen.
teach-warning-symmetric = Gedreht ist es nicht zu unterscheiden.
teach-warning-confusable = Gedreht sieht es sehr ähnlich aus.
teach-warning-weak = Wenig Kontrast: mehr Licht, oder von der Seite.
teach-warning-few-points = Wenige Kanten: ein größerer oder schärferer Ausschnitt hülfe.
teach-warning-few-levels = Klein im Bild: nähere Kameras hülfen.
teach-warning-lopsided = Eine Richtung ist viel schlechter bekannt als die andere.
teach-warning-bright-walls = Wände so hell wie die Fläche: Löcher scheinen zu tief.
teach-warning-uneven = Kanten einer Fläche liegen nicht auf einer Höhe.
teach-warning-one-pair = Ein Paar zeigt nicht, wie Kanten gebrochen sind.
teach-warning-not-found = Es wurde im eigenen Bild nicht wiedergefunden.

## Punkte und Maße
teach-reference = Bezugspunkt
teach-reference-what = Der Punkt, dessen Koordinaten SPS und Roboter bekommen. Vorgeschlagen: der am besten bekannte.
teach-reference-tap = Im Bild antippen
teach-reference-feature = oder die Mitte von
teach-gripping = Greifpunkt
teach-gripping-what = Wo der Greifer fasst, wenn das woanders ist: vom Bezugspunkt aus, entlang der Achsen des Teils.
teach-gripping-tap = Antippen
teach-gripping-type = Eintippen
teach-gripping-none = Kein anderer Ort
teach-tray = Tray
teach-tray-what = Wo Teile in Fächern stehen: Reihen und Spalten in gleichen Schritten, nach den Orten, die für ein Teil in den Ecken gemeldet werden.
teach-tray-columns = Spalten
teach-tray-rows = Reihen
teach-tray-tolerance = Toleranz
teach-tray-first = Erstes Fach
teach-tray-row-end = Letztes Fach der ersten Reihe
teach-tray-column-end = Erstes Fach der letzten Reihe
teach-tray-type = Tray beschreiben
teach-tray-none = Kein Tray
teach-sizes = Maße, die beurteilt werden
teach-sizes-what = An jedem Teil gemessen. Außerhalb von Sollmaß ± Toleranz ist das Teil nicht gut.
teach-size-of = Von
teach-size-to = Bis
teach-size-kind = Was
teach-size-witness = Das Maß, mit dem jedes Teil die Kalibrierung überwacht: immer gemessen.
teach-size-alone = – (das eigene Maß)
teach-size-add = Dieses Maß hinzufügen
teach-size-good = innerhalb
teach-size-bad = außerhalb
teach-size-remove = Das Maß { $name } entfernen
teach-nominal = Sollmaß
teach-tolerance = Toleranz ±
teach-measure-radius = Radius
teach-measure-distance = Abstand
teach-measure-angle = Winkel
teach-measure-width = Breite
teach-measure-length = Länge
teach-measure-height = Höhe
teach-measure-flatness = Ebenheit

## Seine Freigabe
teach-job = Der Auftrag
teach-name = Name
teach-name-wrong = Buchstaben, Ziffern, „_“, „.“ oder „-“, am Anfang ein Buchstabe oder eine Ziffer
teach-number = Nummer an der SPS
teach-activate = Diesen Auftrag benutzen
teach-try = Erst ausprobieren
teach-activate-title = { $name } benutzen?
teach-activate-what = Er wird eine eigene Freigabe. Was auch schiefgeht, die alten bleiben; zurück geht es mit einem Schritt in der Liste der Freigaben.
teach-activated = { $name } ist in Gebrauch, als Freigabe { $number }.

## Was nichts lehrt
problem-teach-no-feature = Es ist kein Kreis, kein Langloch und keine gerade Kante zu sehen, die beide Kameras zeigen. Legen Sie das Teil vor beide, beleuchten Sie es, und tippen Sie es an.
problem-teach-one-sided = Was das linke Bild zeigt, ist im rechten nicht zu finden. Liegt das Teil vor beiden Kameras, und nichts dazwischen? Sonst gehört die Kalibrierung zu anderen Kameras: prüfen Sie sie.
problem-teach-patterned-table = Um das Teil liegen die Löcher eines Lochblechs, und das Teil selbst zeigt nur Kreise um eine Achse, die keine Drehung erkennen lassen. Legen Sie es zum Einlernen auf einen glatten Tisch, oder fügen Sie seine STEP-Datei hinzu.
problem-teach-small-region = Das Gewählte ist leer oder winzig: tippen Sie das Teil an, oder umfahren Sie es.
problem-teach-crossing = Die Linien um das Teil kreuzen sich: setzen Sie die Ecken der Reihe nach um das Teil.
problem-teach-few-edges = Das Gewählte zeigt zu wenige Kanten. Ist das Teil darin, beleuchtet und scharf?
problem-teach-nothing-there = Dort ist nichts mit einem klaren Umriss. Umfahren Sie das Teil, oder beleuchten Sie es so, dass es sich vom Tisch abhebt.
problem-teach-no-pair = Dieser Auftrag wurde anderswo eingelernt und hat kein Bildpaar bei sich: lernen Sie es an einem frischen neu ein.
problem-teach-nothing-left = Es bleibt nichts, womit zu messen wäre: nehmen Sie mindestens einen Kreis, ein Langloch oder zwei Kanten.
problem-teach-no-pictures = Dieser Zyklus hat keine Bilder: die Kameras gaben keine.
problem-teach-other-rig = Dieser Zyklus wurde mit einer anderen Kalibrierung gemessen: was seine Bilder zeigen, liegt inzwischen woanders. Nehmen Sie einen jüngeren.
problem-teach-further-none = Paar { $pair } zeigt dieses Teil nicht einmal und ganz in beiden Bildern: nehmen Sie ein anderes auf oder entfernen Sie es.
problem-teach-further-little = Alle Paare zusammen zeigen zu wenig vom Teil.
problem-teach-further-needless = Dieses Teil hat zu wenige Kurven, um aus weiteren Paaren zu lernen: entfernen Sie diese.
problem-teach-further-size = Dieses Paar ist anders groß als das erste.

teach-further = Weitere Paare
teach-further-what = Gefertigte Kanten sind gebrochen, und ein Teil, das gerade vor den Kameras liegt, zeigt nicht, wie. Legen Sie es um 10 bis 40 Grad gekippt hin oder beleuchten Sie es anders, und nehmen Sie dieses Paar hinzu.
teach-further-add = Ein Paar hinzunehmen
teach-further-said = Das Paar ist dabei.
teach-further-removed = Das Paar ist entfernt.
teach-further-pair = Paar { $number }
teach-further-remove-pair = Paar { $number } entfernen
teach-further-open = Wie die Kanten gebrochen sind, steht nicht fest: Jedes Bild sagt es neu, und das Sigma, wie gut.
teach-further-none = Die Kanten sind scharf.
teach-further-face = Kantenbrüche von { $width } mm; gelernt sind die Kanten in der Fläche.
teach-further-wall = Kantenbrüche von { $width } mm; gelernt sind die Kanten in der Wand.
teach-further-either = Kantenbrüche von { $width } mm; gelernt ist die eine oder die andere Kante.

## Eine Zeichnung statt des Bereichs
teach-drawing = Zeichnung
teach-drawing-what = Der Auftrag lässt sich aus einer DXF-Zeichnung der Fläche lernen, die die Kameras sehen: er hat dann die Maße der Zeichnung. Das Bildpaar zeigt, wo das Teil liegt.
teach-drawing-is = Gelernt aus { $name }, die Fläche { $depth } mm von der linken Kamera.
teach-drawing-back = Ein Tipp auf das Teil oder ein anderer Bereich lernt wieder aus dem Bildpaar.
teach-drawing-more = Einheit, Abstand, Layer
teach-drawing-unit = Einheit
teach-drawing-unit-own = wie die Zeichnung sagt
teach-drawing-depth = Abstand der Fläche; leer: wie ihn das Bildpaar zeigt
teach-drawing-layers = Layer, mit Kommas dazwischen; leer: alle sichtbaren
teach-drawing-choose = DXF-Datei auswählen
teach-drawing-reading = Wird gelesen …
teach-drawing-said = Der Auftrag ist aus { $name } gelernt.
problem-teach-drawing-no-dxf = Das ist keine DXF-Zeichnung, die sich lesen lässt. Exportieren Sie sie neu als DXF.
problem-teach-drawing-unit = Die Zeichnung sagt ihre Einheit nicht: geben Sie sie unter „Einheit, Abstand, Layer“ an und wählen Sie die Datei noch einmal aus.
problem-teach-drawing-layer = Einen solchen Layer hat die Zeichnung nicht. Es gibt: { $there }
problem-teach-drawing-large = Das ist nicht die Zeichnung eines Teils: sie hat zu viele Formen, Punkte oder Bytes. Exportieren Sie nur seine Fläche.
problem-teach-drawing-flat = Die Zeichnung ist nicht eben: exportieren Sie die Fläche als Linien in der x-y-Ebene.
problem-teach-drawing-empty = In der Zeichnung ist kein geschlossener Umriss. Gelesen werden Linien, Bögen, Kreise und Polylinien.
problem-teach-drawing-open = Ein Umriss ist offen: bei x { $x }, y { $y } mm geht es nicht weiter. Schließen Sie ihn, oder nennen Sie die Layer des Teils.
problem-teach-drawing-branch = Bei x { $x }, y { $y } mm schließt sich kein Umriss: eine Abzweigung oder eine doppelt gezeichnete Linie. Bessern Sie es aus, oder nennen Sie die Layer des Teils.
problem-teach-drawing = Die Zeichnung lässt sich nicht verwenden: { $detail }
problem-teach-drawing-depth = Das Bildpaar sagt nicht, wie weit die Fläche weg ist: geben Sie ihren Abstand von der linken Kamera an.
problem-teach-drawing-unread = Der Browser konnte diese Datei nicht lesen.
problem-teach-not-as-drawn = Nichts in diesem Bildpaar gleicht der Zeichnung. Ist es die Fläche, die die Kameras sehen, nicht gespiegelt, in ihrer Einheit, in diesem Abstand, und liegt sie ganz in beiden Bildern?
