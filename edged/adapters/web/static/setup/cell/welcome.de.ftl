# Texts of welcome.js.
welcome-title = { $cell }: einrichten
welcome-new = Neun Schritte von ausgepackten Kameras zum gegriffenen Teil. Ein Haken kommt von dem, was die Zelle hat, nicht von dem, was geklickt wurde.
welcome-complete = Die Zelle hat alles, was sie zum Messen braucht. Jeder Schritt lässt sich ansehen und wiederholen.
welcome-done = Hier fehlt nichts.
welcome-facts = Was die Zelle hat
welcome-later = Mit Befehlen
welcome-later-why = Diese Schritte gibt es noch nicht im Browser. Das Handbuch nennt die Befehle.
next-cameras = Weiter: die Kameras
next-light = Weiter: Licht und Schärfe
next-calibrate = Weiter: kalibrieren
next-check = Weiter: prüfen
next-teach = Weiter: ein Teil einlernen
next-try = Weiter: ausprobieren
next-robot = Weiter: der Roboter
next-plc = Weiter: die SPS, und der Start
fact-cameras = Kameras
fact-cameras-found =
    { $count ->
        [0] keine gefunden
        [one] eine gefunden
       *[other] { $count } gefunden
    }{ $troubled ->
        [0] { "" }
        [one] , eine mit einem Problem
       *[other] , { $troubled } mit einem Problem
    }
fact-unknown = noch nicht nachgesehen
fact-rig-sigma = (±{ $sigma } µm, wo Teile eingelernt wurden)
fact-no-rig = noch keine
fact-no-jobs = noch keine
fact-plc = SPS
fact-plc-owner = schreibt von
fact-no-plc = noch hat keine geschrieben
fact-machine = Dieser Rechner
fact-machine-new = noch nicht untersucht
fact-machine-found = { $bad } schlecht, { $warn } zum Nachsehen
fact-machine-look = Ansehen
fact-error = Fehler
manual-cameras = so richtet man Kameras ein
manual-light = so richtet man Kameras ein
manual-calibrate = so kalibriert man
manual-check = so prüft man
manual-teach = so lernt man ein
manual-try = so läuft der Betrieb
manual-robot = so misst man den Roboter ein
manual-plc = so verbindet man eine SPS
