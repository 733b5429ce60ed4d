# Texte der Seiten, die eine Zelle einrichten. Zahlen kommen mit ihrer Einheit von der Seite.

## Um jede Seite
skip = Zum Inhalt
nav = Seiten
nav-run = Betrieb
nav-setup = Einrichten
nav-jobs = Aufträge
nav-cycles = Zyklen
nav-marks = Marken
nav-accept = Abnahme
nav-space = 3D
nav-settings = Einstellungen
nav-system = System
nav-manual = Handbuch
menu = Konto und Sprache:
language = Sprache
log-out = Abmelden
steps = Der Weg zum gegriffenen Teil
step-of = Schritt { $number } von { $count }:
foot = Schritt davor und danach
understood = Verstanden
back = Zurück
left = Links
right = Rechts
state-starting = STARTET
state-ready = BEREIT
state-busy = MISST
state-fault = FEHLER
state-stopping = HÄLT AN
state-setup = EINRICHTEN
state-setup-by = EINRICHTEN durch { $name }
state-setup-nobody = EINRICHTEN
plc-locked = AUTO_LOCK: die Anlage läuft mit dieser Zelle
plc-owner = SPS
plc-nobody = keine SPS verbunden
connection-lost = Keine Verbindung zur Zelle: neuer Versuch läuft
field-limits = Eine Zahl von { $low } bis { $high } { $unit }
field-number = Eine Zahl, als 0,5 oder 0.5

## Schritte
step-welcome = Willkommen
step-cameras = Kameras
step-light = Licht und Schärfe
step-calibrate = Kalibrieren
step-check = Prüfen
step-teach = Einlernen
step-try = Probieren
step-robot = Roboter
step-plc = SPS und Start
state-tick = erledigt
state-doubt = nochmals ansehen
state-gap = fehlt
state-open = noch nicht begonnen
state-none = hier nicht bekannt

## Wer die Zelle hat
lease = Wer die Zelle hat
lease-free = Die Zelle misst für die Anlage. Um ihre Kameras zu benutzen, übernehmen Sie sie: dann antwortet sie keiner SPS, bis Sie sie zurückgeben.
lease-incomplete = Die Zelle kann noch nicht messen. Übernehmen Sie sie, um sie einzurichten.
lease-locked = Die Anlage läuft mit dieser Zelle (AUTO_LOCK ist 1), deshalb kann niemand sie übernehmen. Schalten Sie die Anlage zuerst auf Handbetrieb.
lease-yours = Sie haben die Zelle. Sie misst nichts für die Anlage, bis Sie sie zurückgeben.
lease-elsewhere = Sie haben die Zelle, an einem anderen Bildschirm. Machen Sie hier weiter, dann sieht jener nur zu.
lease-others = { $name } hat die Zelle. Sie sehen dieselben Bilder und Zahlen, live.
lease-others-view = { $name } hat die Zelle. Sie sehen dieselben Bilder und Zahlen, live; zum Ändern braucht es die Rolle „engineer“.
lease-view = Sie dürfen alles ansehen. Zum Ändern braucht es die Rolle „engineer“.
lease-unattended = Niemand kümmert sich um die Zelle. Sie misst nicht, bis jemand nachgesehen hat, dass niemand darin steht.
lease-take = Zelle übernehmen
lease-take-over = Übernehmen
lease-continue = Hier weitermachen
lease-leave = Zurückgeben
lease-end = Einrichten beenden
idle = { $name }, seit zehn Minuten gab es kein Zeichen von Ihnen, deshalb dürfen Sie nur ansehen. Ihr Passwort bringt Ihre Rechte zurück.
idle-wake = Ich bin da
confirm-title = Ihr Passwort, bitte
confirm = { $name }, das ändert, wer was darf, oder womit die Zelle läuft. Geben Sie Ihr Passwort ein, dann geht es weiter.
confirm-yes = Weiter
password = Passwort
ask-take-title = Zelle übernehmen?
ask-take = Die Zelle beendet den laufenden Zyklus, dann fällt READY: jeder Befehl der SPS wird abgelehnt, bis Sie sie zurückgeben.
ask-take-yes = Übernehmen
ask-over-title = Von { $name } übernehmen?
ask-over = { $name } erfährt es und kann danach nur noch zusehen. Es wird im Protokoll vermerkt.
ask-over-yes = Übernehmen
ask-leave-title = Zelle zurückgeben?
ask-leave = Es gelten wieder die aktiven Einstellungen, ein Probepaar wird aufgenommen, dann ist die Zelle BEREIT. Niemand darf in der Zelle stehen, und keine Tafel darf darin liegen.
ask-leave-yes = Zurückgeben
ask-end-title = Ist niemand in der Zelle?
ask-end = Das darf nur sagen, wer nachgesehen hat: danach wird die Zelle BEREIT, und die Anlage kann anlaufen.
ask-end-yes = Ich habe nachgesehen: niemand ist darin

## Was nicht ging: Ursache und Abhilfe
problem-other = Das ging nicht: { $detail }
problem-unreachable = Die Zelle antwortet nicht. Prüfen Sie Netzwerkkabel und Zellen-PC; die Seite versucht es von selbst wieder.
problem-page = Diese Seite war nicht zu holen. Laden Sie sie neu, sobald die Zelle antwortet.
problem-log-in = Sie sind nicht mehr angemeldet. Melden Sie sich neu an.
problem-origin = Der Browser hat nicht gesagt, dass diese Seite fragt. Öffnen Sie die Seite unter ihrer eigenen Adresse.
problem-setup-refused = Das geht gerade nicht: { $detail }
problem-lease-lost = Sie haben die Zelle nicht mehr: die Zeile darüber sagt, wer sie hat. Was Sie bis dahin getan haben, ist gespeichert.
problem-lease = Sie haben die Zelle nicht mehr: die Zeile darüber sagt, wer sie hat. Was Sie bis dahin getan haben, ist gespeichert.
problem-role = Ihre Rolle erlaubt das nicht. Jemand mit der Rolle „engineer“ kann es.
problem-idle = Seit zehn Minuten gab es kein Zeichen von Ihnen. Geben Sie Ihr Passwort noch einmal ein.
problem-password = Das ist nicht das Passwort.
problem-confirm = Dafür ist Ihr Passwort noch einmal nötig.
problem-weak-password = Dieses Passwort ist zu leicht zu erraten. Nehmen Sie eines aus mehreren Wörtern, ohne Ihren Namen.
problem-exists = Es gibt schon jemanden mit diesem Namen, oder mit einem, der genauso aussieht.
problem-wait = Zu viele Versuche. Warten Sie { $wait_s } s.
problem-invalid = Das nimmt die Zelle nicht an: { $detail }
problem-unknown = Das gibt es nicht, oder nicht mehr. Laden Sie die Seite neu.
problem-input = Das nimmt die Zelle nicht an: { $detail }
problem-storage = Die Platte des Zellen-PCs ist voll. Schaffen Sie Platz und versuchen Sie es noch einmal.
problem-stale = Jemand anderes, oder ein anderer Bildschirm, hat das inzwischen geändert. Sie sehen jetzt das Neuere: sehen Sie es an, dann machen Sie Ihres noch einmal.
problem-regression = Gute aufgezeichnete Zyklen werden dadurch schlecht, oder es wurde nicht an ihnen versucht: Das geht auf der Seite Zyklen, das Übernehmen auch.
problem-teach-name = Das kann kein Name sein: Buchstaben, Ziffern, „_“, „.“ und „-“ sind möglich, zuerst ein Buchstabe oder eine Ziffer.
problem-teach-name-taken = Den Auftrag { $name } gibt es schon: ändern Sie jenen, oder wählen Sie einen anderen Namen.
problem-teach-number-taken = { $number } ist die Nummer von { $name }; { $free } ist frei.
problem-teach-name-old = Was so endet, ist ein ersetzter Auftrag: wählen Sie einen anderen Namen.
problem-image-size =
    Das { $side ->
        [left] linke
       *[right] rechte
    } Bild hat { $found } Pixel, und die Kalibrierung ist von { $wanted }: Stellen Sie die Kameras wieder darauf ein, oder kalibrieren Sie sie, wie sie jetzt sind.
problem-task-failed = Die Arbeit der Zelle daran endete ohne Ergebnis. Wenn das wieder geschieht, sehen Sie in ihr Protokoll (journalctl -u edged).
problem-task-too-large = Das brauchte mehr Speicher oder Rechenzeit, als die Zelle dafür ausgeben darf, und wurde beendet: nehmen Sie weniger oder kleinere Bilder, oder eine kleinere Zeichnung.
problem-gone = Dieses Bild ist nicht mehr da. Nehmen Sie ein neues auf.
problem-status-404 = Diese Zelle bietet das nicht an. Bringen Sie edged auf dem Zellen-PC auf den neuen Stand und laden Sie die Seite neu.
problem-status-500 = Die Zelle hat selbst einen Fehler gemacht: sehen Sie in ihr Protokoll (journalctl -u edged).

## Live-Bilder
live-left = Linke Kamera, live
live-right = Rechte Kamera, live
live-waiting = Das erste Bild kommt gleich.
live-watching = Ein Bild kommt, sobald auf die Kameras sieht, wer die Zelle hat.
live-take = Kein Bild: übernehmen Sie die Zelle, um ihre Kameras zu sehen.

## Auf mehreren Seiten
fact-rig = Kalibrierung
fact-jobs = Aufträge
keep-what = Das ist ein Versuch: wenn Sie die Zelle zurückgeben, ist es wie zuvor, außer Sie behalten es.
keep-calibrate = Diese Kameras sind ein Versuch. Kalibriert wurde mit den bisherigen: kalibrieren Sie neu, dann übernimmt die Zelle beides zusammen.
keep = Behalten
kept = Behalten.
board-title = Welche Tafel?
board-recognise = In den Bildern erkennen
board-state = Ich gebe sie an
board-kind = Art
kind-chessboard = Schachbrett
kind-charuco = ChArUco
kind-dots = Punktplatte
kind-circles = versetzte Kreise
board-columns = Innere Ecken (oder Marken) je Zeile
board-rows = Zeilen davon
board-marker = Kante eines Markers
board-dictionary = Wörterbuch der Marker
board-mm = Kante eines Feldes
board-pitch = Von Marke zu Marke
board-goal = Ziel: ein Punkt im Messraum auf ±
board-proof = Messen Sie die Länge mit dem Messschieber über viele Felder. Nichts in den Bildern kann sie beweisen, und jede Koordinate hängt daran.
board-begin = Beginnen
board-begin-auto = Beginnen und Ansichten selbsttätig aufnehmen
board-still = Die Tafel ist ruhig.
board-moves = Halten Sie die Tafel einen Augenblick ruhig.
view = Ansicht { $name }

## Was eine Freigabe wird, und wer dafür unterschreibt
release-note = Warum (für alle, die es später ansehen)
release-making = Einen Augenblick …
sign-worse =
    { $count ->
        [one] Ein aufgezeichneter Zyklus, der gut war, wird dadurch schlecht.
       *[other] { $count } aufgezeichnete Zyklen, die gut waren, werden dadurch schlecht.
    }
sign-untried =
    { $count ->
        [one] Am aufgezeichneten Zyklus, den es betrifft, wurde es nicht versucht.
       *[other] An den { $count } aufgezeichneten Zyklen, die es betrifft, wurde es nicht versucht.
    }
sign-look = Ansehen
sign-try = An ihnen versuchen
sign-what = Wenn es so sein soll, sagen Sie warum: es steht bei der Freigabe, und mit Ihrem Namen im Protokoll.
sign-reason = Warum es so sein darf
sign = Unterschreiben: { $label }

## Die virtuelle Bühne von edged demo --stage
stage-title = Virtuelle Bühne: Ihre Hände in dieser Vorführung
stage-what = Diese Kameras sind virtuell. Hier tun Sie, was in einer echten Zelle die Hände tun.
stage-board = Die Tafel ist ein Schachbrett mit { $columns } × { $rows } inneren Ecken; ein Feld ist { $mm } mm breit.
stage-show-board = Tafel halten
stage-show-part = Teil hinlegen
stage-show-nothing = Nichts
stage-lay = Das Teil anderswo hinlegen
stage-truth = Das letzte Ergebnis liegt um { $x } µm in X, { $y } in Y, { $z } in Z daneben.
stage-truth-none = Sobald die Zelle das Teil misst, steht hier ihr Fehler.
stage-hand = Tafel an den gestrichelten Ort bringen
stage-still = Tafel ablegen
stage-follow = Dem gestrichelten Ort folgen
stage-wave-left = Vor der linken Kamera winken
stage-wave-right = Vor der rechten Kamera winken
stage-ring-left = Ring des linken Objektivs
stage-ring-right = Ring des rechten Objektivs
stage-ring = { $turn } einer Vierteldrehung

## Ein Bild, das man genau ansieht
zoom = Vergrößerung
zoom-in = Näher
zoom-out = Weiter weg
zoom-all = Alles

## Entwürfe
draft-begun = Zuvor begonnen
draft-go-on = Weiter damit
draft-go-on-with = Weiter damit: { $name }
draft-discard = Verwerfen
draft-discard-name = { $name } verwerfen
draft-discard-title = { $name } verwerfen?
draft-broken = Sie lässt sich nicht mehr lesen.

## Tasten
keys = Tastatur
keys-steps = Zum Schritt mit dieser Nummer
keys-beside = Zum nächsten Schritt, zum vorigen
keys-main = Zum Knopf am Fuß
keys-undo = Die letzte Änderung an einem Entwurf rückgängig machen
keys-redo = Sie wiederholen
keys-close = Schließen, was offen ist
keys-list = Diese Liste
keys-ctrl = Strg
keys-single = Einzelne Tasten wirken (nicht, während Sie schreiben)

## Fehler der Kameras, nach der Nummer der SPS
fault-other = Ein Fehler der Zelle.
fault-100 = Eine Kamera hat nichts geliefert.
fault-101 = Eine Kamera wird nicht gefunden oder antwortet nicht: sehen Sie nach Kabel und Strom.
fault-102 = Ein anderer Rechner steuert eine Kamera.
fault-103 = Eine Kamera nimmt eine Einstellung nicht an.
fault-104 = Kein Bild kam rechtzeitig: sehen Sie nach Auslöser, Licht und Kabel.
fault-105 = Ein Bild kam beschädigt an: im Netz gingen Pakete verloren. Sehen Sie nach Kabeln und Switch, und prüfen Sie die Pakete auf der Seite „Kameras“.
fault-106 = Zwei Bilder stammen nicht von derselben Belichtung.
fault-107 = Eine Kamera wurde aus- und eingeschaltet.
fault-108 = Das ist eine andere Kamera als die kalibrierte: Kabel oder Adressen sind vertauscht.
fault-109 = Eine Kamera hat ein Bild noch einmal geschickt.
fault-110 = Eine Kamera schickt immer wieder dasselbe Bild.
fault-111 = Eine Kamera hat belichtet, die andere nicht.
fault-112 = Eine Kamera antwortet, schickt aber keine Bilder.
fault-113 = Zwischen den beiden Belichtungen hat sich etwas bewegt, oder das Licht war anders: Das Teil muss still liegen.
measures-again = Die Zelle versucht es weiter: Mit dem nächsten guten Paar misst sie wieder.
draft-settings = Gewählt und noch nicht in Kraft
draft-use = Diese Einstellungen verwenden
draft-put = In Kraft setzen
draft-discarded = Der Entwurf ist verworfen.
draft-used = Die Zelle arbeitet mit diesen Einstellungen.
diff-nothing = nichts
diff-yes = ja
diff-no = nein
diff-option = { $name }: { $before } → { $after }
diff-password = { $name }: ein anderes Passwort
